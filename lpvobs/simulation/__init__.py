"""Drive cycles, the nonlinear plant, its sensors, and effects that are put into them."""
