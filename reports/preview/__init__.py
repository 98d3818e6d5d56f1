"""Pictures of a log that show at one look whether calibration, time and Doppler are right."""
