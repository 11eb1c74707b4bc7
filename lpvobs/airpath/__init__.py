"""What the engine does: relations of its components, and the LPV form that the observer needs."""
