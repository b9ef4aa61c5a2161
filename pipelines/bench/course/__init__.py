"""The course of `bench video`: camera, thin channel and screen around what is measured."""
