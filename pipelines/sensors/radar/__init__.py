"""Detection by radar: `radar.py`, with ego motion and velocities in `doppler.py`."""
