"""What is wrong with a set-up or a session: one table of rules, for the live coach and for all reports."""
