"""One coded stream, from end to end: schedule, budget, RTP, reception and display."""
