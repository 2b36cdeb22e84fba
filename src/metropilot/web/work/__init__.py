"""What workers compute: plain values in, plain values out. Each runs in a process of its own."""
