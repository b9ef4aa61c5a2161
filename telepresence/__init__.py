"""The radio link and the hand: what shares the channel with the media."""
