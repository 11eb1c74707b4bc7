"""Foreign recordings: how they are opened, named and brought to the stamps of one log."""
