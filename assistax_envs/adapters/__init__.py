"""The environment behind other libraries' interfaces, one module each: jaxmarl, pettingzoo, gymnasium.

JaxMARL's interface needs nothing installed; the other two need `pip install
'assistax-zoo[adapters]'`.
"""
