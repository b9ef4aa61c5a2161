"""Model-mediated haptics: a wall is estimated on the ground and rendered at the operator's side."""
