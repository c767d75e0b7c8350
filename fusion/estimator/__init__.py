"""The default method: an estimator in time, one Kalman filter a joint, robust, with hard bones.

One pair goes through the steps of :func:`fusion.estimator.estimator.estimate_pair`; each step is a module
named after what it computes.
"""
