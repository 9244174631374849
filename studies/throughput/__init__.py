"""How long `knee-contact solve` takes for a long recording, beside merely reading and writing the same messages."""
