"""Parts that several engines have."""
