"""One coded stream, from end to end: when to encode, what may leave, what is shown."""
