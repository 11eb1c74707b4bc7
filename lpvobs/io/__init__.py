"""Files: logs, results and gains, calibration files, configuration, and what keeps all of them safe."""
