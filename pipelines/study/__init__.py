"""The study of hands: how stiffness, damping and inertia of the handle change what a hand can do.

It runs alone: no session, no radio. `plan.py` has what is varied, in which order, and the trials.
`trials.py` leads a person through them. `effects.py` finds what made a difference, and draws
it. `running.py` has the files and the page.
"""
