"""Live submissions: the robot stays at home, its client dials out, and answers observations.

    worker --HTTP--> server <--WebSocket-- client
     observe(batch, step)  ->  observe  ->
                           <-  act      <-

Batches of episodes go in lockstep. Steps are numbered, so either side may send one again: a lost
connection is resumed where it broke, and is never a bad score.
"""
