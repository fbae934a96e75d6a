"""MJCF scenes and the function that compiles them."""

from assistax_envs.models.build import build_dressed, build_model

__all__ = ["build_dressed", "build_model"]
