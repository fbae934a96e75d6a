"""Trainers: PPO and SAC, what they share, and whom they train with."""
