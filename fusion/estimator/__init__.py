"""The default method: a robust Kalman filter per joint, with hard bone lengths.

One pair goes through the steps of :func:`fusion.estimator.estimator.estimate_pairs`; each step is a module
named after what it computes.
"""
