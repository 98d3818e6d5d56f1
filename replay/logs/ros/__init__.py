"""Codec for ROS messages, without ROS: CDR (ROS 2) and the serialization of ROS 1."""
