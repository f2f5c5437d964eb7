"""Programs that regenerate figures of the documentation; they run in a clone and are in no wheel."""
