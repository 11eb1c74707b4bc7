"""A diesel with EGR and VGT: the paper's engine."""
