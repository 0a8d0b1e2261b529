"""The sky wing: corrected frames become an identification and an attitude."""
