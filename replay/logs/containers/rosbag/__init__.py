"""Rosbag."""
