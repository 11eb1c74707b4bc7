"""The observer as C99 for a control unit, and as a unit for co-simulation."""
