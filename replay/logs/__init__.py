"""Logs: containers (MCAP, Parquet, recordings of ROS), codecs of messages (Foxglove, ROS), and conversion."""
