"""The commands of `knee-contact`; heavy libraries load only where a command runs."""
