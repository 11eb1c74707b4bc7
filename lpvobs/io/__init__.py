"""Files: logs, configuration, gains, results."""
