"""What lies between transfer frames and the datagrams of a path to another machine. Cores."""
