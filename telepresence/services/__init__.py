"""TCP services across the link: a few ordered octet streams, in contact only."""
