"""Recordings of ROS: folders of rosbag2 and their SQLite files, and bags of ROS 1."""
