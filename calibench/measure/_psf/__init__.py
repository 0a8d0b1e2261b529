"""What `psf` is made of: shapes of single spots, the shape over the field, the figures labs quote."""
