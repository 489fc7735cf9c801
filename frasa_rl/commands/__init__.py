"""The commands of frasa-rl, one file each: arguments, and what they do."""
