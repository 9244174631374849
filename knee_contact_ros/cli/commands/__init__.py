"""The commands of `knee-contact`, one file a purpose; heavy libraries load only where a command runs."""
