"""From the bytes of messages to answers, live and offline: messages, pairing by stamps, contact, load, gait events."""
