"""A session as a page: what the reviewer asks first, every decision with its reasons, and the way of the arm."""
