"""A folder of results as a data set: the ``.vola`` index, STAC, mosaics of the models."""
