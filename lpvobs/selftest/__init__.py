"""The installed package against cases whose answers are known beforehand."""
