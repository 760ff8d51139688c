"""The calibration certificate: synthetic specimens through the whole program, and what every stage is off by."""
