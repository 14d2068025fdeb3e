"""Recordings in MCAP: writer, reader, recover, export; no ROS is imported here."""
