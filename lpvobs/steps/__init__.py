"""The steps of the chain as one call each: files in, numerics, files out."""
