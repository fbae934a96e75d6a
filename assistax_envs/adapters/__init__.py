"""Adapters of the environment to other libraries' interfaces, one module each.

They are gymnasium, pettingzoo, jaxmarl and stable_baselines. Each has a vector form with hundreds
of simulations in one program; the first three also have a form with one simulation.
docs/train_your_own.md compares them.

JaxMARL's interface needs nothing installed; the others need `pip install 'assistax-zoo[adapters]'`,
and Stable-Baselines3's also the extra `sb3`.
"""
