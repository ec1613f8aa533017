"""Motors, servo, drive and joint friction between the station's input ports and the plant."""
