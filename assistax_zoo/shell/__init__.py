"""The command line around the commands: errors, interrupts, printing, the machine."""
