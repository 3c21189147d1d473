"""What instruments are off by, found from recordings: ranges, radios, IMUs, Doppler logs."""
