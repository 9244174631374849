"""Methods that carry the femur over one step."""
