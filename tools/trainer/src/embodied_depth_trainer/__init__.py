"""Trains and exports the networks that the robot runs."""
