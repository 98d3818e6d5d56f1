"""Multi-object tracking: constant-velocity Kalman filters and optimal association."""
