"""The observer's gain (Sec. 3): linear matrix inequalities, solution, exact certificate."""
