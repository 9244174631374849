"""Where samples come from: messages, live or from a bag, become samples in the model's units and signs."""
