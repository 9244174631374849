"""The command line of the package: `knee-contact` with its commands and options."""
