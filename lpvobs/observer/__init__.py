"""The recursion of Eq. (26) and (36), and what it estimates."""
