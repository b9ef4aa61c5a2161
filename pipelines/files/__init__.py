"""Files between the directories of the two ends, beside the media."""
