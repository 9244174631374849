"""`knee-contact fit-profile`: from a mesh of cartilage to a profile that the model takes."""
