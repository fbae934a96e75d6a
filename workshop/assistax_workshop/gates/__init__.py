"""Gates: does a task need its partner, and is it done gently?"""
