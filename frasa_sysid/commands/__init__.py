"""The subcommands of `frasa-sysid`: each has `add_parser(subparsers)` and `run(args)`."""
