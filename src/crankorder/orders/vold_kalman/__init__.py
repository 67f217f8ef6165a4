"""The second-generation Vold–Kalman filter: orders followed from sample to sample, at any bandwidth."""
