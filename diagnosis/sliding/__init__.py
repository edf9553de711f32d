"""While a servo slides its friction is a known function: a Kalman filter gives the likelihood of its
records, in open and in closed loop.
"""
