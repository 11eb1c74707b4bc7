"""From bench tables and healthy logs to what is known of an engine: constants, corrections of its components, their covariance."""
