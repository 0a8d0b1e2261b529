"""What `dark` is made of: levels, the ladder through them, the pixels that stand out, temperatures."""
