"""The report on surveys closed from their own navigation (Table V)."""
