"""Files that appear whole or not at all, and what a stranger's file may not do."""
