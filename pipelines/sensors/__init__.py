"""Sensors: from messages to what cameras, LiDARs, radars and stereo pairs see, each in a folder of its own."""
