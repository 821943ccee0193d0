"""``cutgate audit report``: sessions as one page that loads nothing."""
