"""What `flat` is made of: light levels, illumination apart from response, dust, figures."""
