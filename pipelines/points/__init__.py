"""Stages on points of LiDAR and radar: ground, clustering, Doppler, box fitting."""
