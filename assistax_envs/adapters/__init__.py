"""The environment behind other libraries' interfaces, one module each.

They are gymnasium, pettingzoo, jaxmarl and stable_baselines: a vector form of each has hundreds of
simulations in one program, and the first three have one simulation too. docs/train_your_own.md
compares them.

JaxMARL's interface needs nothing installed; the others need `pip install 'assistax-zoo[adapters]'`,
and Stable-Baselines3's also the extra `sb3`.
"""
