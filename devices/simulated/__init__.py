"""Simulates two Kinects in front of a person whose true joints are known."""
