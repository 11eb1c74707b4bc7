"""Drive cycles, the nonlinear plant and its sensors."""
