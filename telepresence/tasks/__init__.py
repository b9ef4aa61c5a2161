"""Tasks: operations in XML, the kernel that executes them, and what both ends do for a task."""
