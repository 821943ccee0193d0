"""The audit log: one MCAP file a session, written before anything is enabled, checked and replayed afterwards."""
