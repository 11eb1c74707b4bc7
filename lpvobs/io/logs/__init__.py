"""Logs: found, read, checked, written."""
