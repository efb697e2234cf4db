"""The command line: one module per subcommand of `embodied-depth`, with its options and what it runs."""
