"""Inputs: a camera, a file, a live pipe, a microphone, or a scene that someone else renders."""
