"""Results as plain content, figures and one HTML page."""
