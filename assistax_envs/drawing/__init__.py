"""Pictures of simulations: OpenGL, the renderer, and the figures beside the scene."""
