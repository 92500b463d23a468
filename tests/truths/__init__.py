"""Systems, records and studies with known answers, and spoilt inputs, shared by the tests."""
