"""The environment behind other libraries' interfaces, one module each.

They are jaxmarl, pettingzoo and gymnasium.

JaxMARL's interface needs nothing installed; the other two need `pip install
'assistax-zoo[adapters]'`.
"""
