"""The two-dimensional map (Sec. 2.2): grid, interpolation, visited cells, quadratic extrapolation."""
