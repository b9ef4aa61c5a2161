"""Sight, hearing and touch compared by what they show, not by what their stamps say.

A contact in the world lights an LED, sounds a click and steps the force in one instant. Each is
found again where it is seen, heard and felt (`watching`, `telepresence.haptics.step_detector`),
joined to its contact (`matching`), and judged (`figures`, `limits`).
"""
