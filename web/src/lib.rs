//! Browser binding of landline: converts types and nothing else.
