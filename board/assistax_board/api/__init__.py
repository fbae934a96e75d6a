"""HTTP: parse, call one method of `Service`, answer. No rule of the service lives here."""
