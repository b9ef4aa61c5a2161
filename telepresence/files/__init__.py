"""Files across the link: CFDP class 2 (CCSDS 727.0-B-5) on the maintenance level."""
