"""The command line: a module per command, gathered by `app`. May import every other room."""
