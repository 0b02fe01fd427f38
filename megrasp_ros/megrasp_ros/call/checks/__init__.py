"""What `megrasp_call doctor` looks at: a file each for machine, server, input, listeners."""
