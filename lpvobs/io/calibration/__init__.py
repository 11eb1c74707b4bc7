"""The map in files for calibration tools."""
