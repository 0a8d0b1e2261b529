"""Bundle adjustment: one lens seen through blocks of views (boards, star frames), each block with its own kind of pose."""
