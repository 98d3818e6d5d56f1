"""Tests of recordings of ROS."""
