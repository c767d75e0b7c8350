"""How good a session is: its figures, the doubtful seconds and the verdict."""
