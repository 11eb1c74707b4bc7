"""Results and gains in HDF5."""
