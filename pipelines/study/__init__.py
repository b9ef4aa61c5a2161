"""The study of hands: how stiffness, damping and inertia of the handle change what a hand can do.

It runs alone: no session, no radio. `plan.py` is what is varied, and in which order. `trial.py` is
one trial and its figures, `desk.py` leads a person through all of them, `hands.py` is people on
virtual time. `effects.py` finds what made a difference, and draws it. `results.py` has the
files, `server.py` the page.
"""
