"""The command `knee-contact`."""
