"""Maps of many vehicles over time, as a hierarchy of type, vehicle and time, from the stored sums of logs. No log is read here."""
