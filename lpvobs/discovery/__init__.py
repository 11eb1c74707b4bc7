"""The closed loop: what the residual of every balance holds, which effect explains it, and the model with it."""
