"""A session as a node of a ROS 2 system: its topics out, a hand in."""
