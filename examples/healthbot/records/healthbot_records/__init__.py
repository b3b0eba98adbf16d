"""Patient records: a small FHIR R4 web service, and the component that feeds it."""
