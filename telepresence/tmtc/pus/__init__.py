"""The packet utilisation standard (ECSS-E-ST-70-41C) over the TM/TC flow: services as cores."""
