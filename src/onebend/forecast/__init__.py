"""A push rehearsed before it is filmed: how well k(s) would come out, and what to change."""
