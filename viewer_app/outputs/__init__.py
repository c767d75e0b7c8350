"""Live outputs: S* sent to other programs while the loop runs.

An encoder is a pure function of values. An output is a sink with a bounded queue and a thread of its own.
"""
