"""Readers of foreign files, a module per format: each returns a `ForeignTable` (rosbag and bag_commands share one)."""
